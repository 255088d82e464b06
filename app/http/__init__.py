"""The middleware that every request passes, and errors as problems. Imports api and below."""
