"""Writing files: one format a module, one atomic writer for all of them."""
