"""The one use case: a frame in, persons with hypotheses out."""
