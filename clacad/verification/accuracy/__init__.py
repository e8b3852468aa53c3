"""What accuracy costs in time: the same rays up every rung, each with its error and its seconds.

The truth is rung surfaces in float64, which is itself held to a trace in 50 digits.
"""
