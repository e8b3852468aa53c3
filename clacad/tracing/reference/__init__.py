"""The tracer in numpy, the reference for the compiled one: launch, column, face, walk, and the rungs.

Files of the same name in `compiled` are the twins.
"""
