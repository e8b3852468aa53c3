"""The paper's figures and movies, reproduced and measured."""
