"""The paper's own equations, each one small function with its number, and the chain that they form."""
