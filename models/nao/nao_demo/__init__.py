"""The paper's case study as a play on running processes: `cfgplan demo nao`."""
