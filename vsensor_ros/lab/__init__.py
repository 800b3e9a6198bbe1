"""The laboratory: demos and injected faults, played over real topics against a replacer."""
