"""A simulated plant made of the component models, with faults: for the demo, tests and back-tests."""
