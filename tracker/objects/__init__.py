"""Objects the tracker knows: their size, the colours of their faces, and labels of colours."""
