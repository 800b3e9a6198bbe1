"""
Faults injected into a replacer from outside: a played machine, an isolator, a judge.

`world` is the truth, `rig` plays it on the topics and hears what comes back, `verdict` compares,
`stage` is what a case acts on, `cases`, `hostile` and `ends` hold the cases, `suite` runs them.
Nothing here looks into the replacer: of its wing only the accessors of messages are used.
"""
