"""Scene files to start from, commented: `softrod init NAME` copies one."""
