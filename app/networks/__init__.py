"""What was learned: the files that ship, verified and read in one way, and what runs them."""
