"""Attacks with files: mutants by number, each given to `verify` as an untrusted file, and the allowed results."""
