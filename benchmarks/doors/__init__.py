"""What arrives from outside: fuzzers over every decoder, and a daemon that is killed at random moments."""
