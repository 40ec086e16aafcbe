"""Object models: the size of a cuboid and the colours of its faces; the labels of colours."""
