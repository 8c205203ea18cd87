"""Sample models: each file reads top to bottom and stands alone."""
