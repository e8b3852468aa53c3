"""Accuracy compared with its cost in time: the same rays on every rung, each with its error and its seconds.

The truth is rung surfaces in float64, which is itself checked against a trace in 50 digits.
"""
