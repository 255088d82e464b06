"""Frame to people: boxes with scores, and which way up each person is."""
