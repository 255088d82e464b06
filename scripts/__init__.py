"""Commands that build, train, measure and draw: ``python -m scripts`` lists them."""
