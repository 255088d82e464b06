"""Golden answers: the replies to a table of requests, compared by a test, written by a command."""
