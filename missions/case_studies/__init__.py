"""Case studies: many runs of one question, as a table."""
