"""What tests of several folders share: a module a noun."""
