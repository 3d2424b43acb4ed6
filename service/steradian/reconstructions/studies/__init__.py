"""Analyses of a scan: speed of sound, retrospective undersampling, widths of objects."""
