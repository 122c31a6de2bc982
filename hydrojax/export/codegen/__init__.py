"""C from a jaxpr: every element a number, every operation a line."""
