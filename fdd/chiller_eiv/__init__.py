"""Chiller health by the Gordon-Ng model, re-estimated with an errors-in-variables correction."""
