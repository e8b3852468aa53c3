"""The paper's figures and movies, drawn anew and measured."""
