"""The operator's page: commands, live figures and the state of a session in the browser."""
