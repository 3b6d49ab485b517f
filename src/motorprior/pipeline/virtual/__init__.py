"""Virtual robots: simulated bodies and motors behind the wire of a real robot."""
