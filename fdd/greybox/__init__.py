"""What turns equations into filters: trace, kernels, likelihood, fit, validate, simulate."""
