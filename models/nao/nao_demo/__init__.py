"""The paper's case study, performed step by step on running processes: `cfgplan demo nao`."""
