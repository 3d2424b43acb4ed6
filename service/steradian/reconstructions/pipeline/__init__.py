"""From a scan file to a volume file: parameter resolution, plan cache, execution, diagnostics."""
