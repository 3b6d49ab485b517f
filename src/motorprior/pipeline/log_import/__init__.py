"""Import recordings of any robot as motor logs."""
