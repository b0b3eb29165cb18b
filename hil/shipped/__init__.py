"""Files that come with the package: the example rig file and the shipped controllers."""
