"""How punctual collection in wall-clock time is, and what it loses when learners die."""
