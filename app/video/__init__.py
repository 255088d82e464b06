"""Videos, decoded in processes of their own. Imports scheduling and below."""
