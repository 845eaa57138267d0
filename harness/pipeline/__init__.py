"""One trial: from its specification through render, match and errors to a row of results."""
