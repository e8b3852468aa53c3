"""The tracer in numpy, which the compiled one is held to: launch, column, face, walk, and the rungs.

Files of the same name in `compiled` are the twins.
"""
