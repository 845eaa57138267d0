"""From a specification to rows of results."""
