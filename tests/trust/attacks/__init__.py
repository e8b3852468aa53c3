"""Attacks with files: mutants by number, each handed to `verify` as a stranger's, and what may come of it."""
