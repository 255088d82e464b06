"""An upload to people, and people to poses and postures. Imports vision, index and below."""
