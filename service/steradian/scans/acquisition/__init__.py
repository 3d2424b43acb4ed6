"""Acquisition: execution of scan plans on a scanner, resumption, emergency stop and fault clearing."""
