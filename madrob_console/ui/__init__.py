"""The referee's screens. They show snapshots and hand in acts; they hold no rule."""
