"""Laws that every solver is held against: named cases with closed forms, one module per kind."""
