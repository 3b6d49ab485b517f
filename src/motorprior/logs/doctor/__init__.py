"""The log doctor: checks of a log, and findings that prevent the identification of motors."""
