"""What crosses the socket: the state that screens show and what they may ask.

Plain data: who makes it is in live, who carries it is in process.
"""
