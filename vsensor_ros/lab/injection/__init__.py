"""
Faults injected into a replacer from outside: a played machine, an isolator, a judge.

`truth` is what the plant does, `machine` plays it on the topics and hears what comes back,
`verdict` compares; `under_test` describes the replacer. `case` says what a case is and
`case_context` what it acts on; `sensor_cases`, `message_cases` and `restart_cases` hold them,
`suite` runs them, `table` shows what became of them. Nothing here looks into the replacer: of its
wing only the accessors of messages are used, and the names and defaults of its parameters.
"""
