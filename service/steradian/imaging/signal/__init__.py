"""Signal processing of A-lines: bandwidth, decimation, conditioning."""
