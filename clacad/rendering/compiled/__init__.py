"""Compiled search for what rays meet in a scene, and the one kernel from pixels to light."""
