"""`explain`: what a code, a check or a word means, why it matters, what is computed, what to do."""
