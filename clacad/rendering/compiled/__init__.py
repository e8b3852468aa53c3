"""What rays meet in a scene, compiled, and the one kernel from pixels to light."""
