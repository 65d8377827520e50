"""What reads MATLAB files in a process of its own: damage, or what a file claims, can bring that down."""
