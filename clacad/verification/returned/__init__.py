"""Parts that came back: where they lie in their file, how far they are off, and what was done to them."""
