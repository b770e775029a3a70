"""Who may do what on a bus that several hosts share: certificates, and the rights that go with them."""
