"""Measured parts: their pose in the file, their deviation from the design, and damage to them."""
