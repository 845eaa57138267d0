"""For the test suites of others: what every matcher has to do, and error bounds with a reason."""
