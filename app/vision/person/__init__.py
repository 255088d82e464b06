"""One pass a person: the window about them, and what the landmark network reads in it."""
