"""What every request passes and every error becomes. Imports api and below."""
