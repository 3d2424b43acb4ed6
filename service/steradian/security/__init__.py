"""Who may do what: keys, their scopes and the rule under which a service starts at all."""
