"""Building an index by simulation. Needs the ``build`` extra; never imported by the service."""
