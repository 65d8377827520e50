"""What happens to damaged files, killed runs, full disks and missing parts of the system."""
