"""For other projects' test suites: checks that every matcher has to pass, and error bounds with a reason."""
