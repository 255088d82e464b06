"""A model of capacity: measured costs, one replica as a queue, a day of cameras."""
