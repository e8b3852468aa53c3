"""Where cells meet: borders, nodes and rims of one cell. Mesh and B-Rep both build from it; neither is here."""
