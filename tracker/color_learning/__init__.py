"""Learning of colour models, from labelled images or from recordings without labels."""
