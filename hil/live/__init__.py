"""The page in the browser: what the loop sends to it, the process that serves it, and the page itself."""
