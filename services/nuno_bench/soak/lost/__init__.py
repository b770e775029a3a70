"""Nothing lost: messages by the hundred thousand, through the hub into a recording."""
