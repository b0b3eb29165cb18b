"""Operation of a running daemon from outside: the protocol, the process that serves it, and the client.

=======================  ====================================================================
``protocol``             messages between daemon and clients; the one description of them
``pipe``                 messages between the loop and the socket process
``socket_path``          where the socket is, and how a daemon takes it
``server``               serves the clients, with limits
``server_process``       the socket process: starts the server again when it ends
``client``               :class:`~hil.operation.client.Client` for Python programs
``systemd``              readiness and watchdog notifications
``unit_files``           installs the shipped systemd files
=======================  ====================================================================
"""
