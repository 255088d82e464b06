"""From an upload to people, and from people to poses and postures.

Imports vision, index and below.
"""
