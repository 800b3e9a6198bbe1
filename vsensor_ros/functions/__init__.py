"""The language of equations: expressions, their functions, and nonlinear terms made of them."""
