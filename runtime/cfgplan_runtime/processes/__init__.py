"""The backend whose units are processes of this machine."""
