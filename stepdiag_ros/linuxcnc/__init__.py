"""A real LinuxCNC: what it is compensated with, how it is configured, started and watched."""
