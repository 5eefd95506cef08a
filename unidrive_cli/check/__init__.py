"""Rules that a dataset must keep, each with an ID; run on the input and on our own output."""
