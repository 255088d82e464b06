"""The one use case: a frame in, people with hypotheses out."""
