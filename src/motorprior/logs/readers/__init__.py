"""Log formats, one file each: `read_log` finds the READER of every module here."""
