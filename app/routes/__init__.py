"""HTTP routes, one file per resource. Imports serving and below."""
