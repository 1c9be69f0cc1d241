"""Examples of the solver as a library, each a program of its own."""
