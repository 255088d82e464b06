"""The experiments, one module each; ``scripts/evaluate.py`` runs them."""
