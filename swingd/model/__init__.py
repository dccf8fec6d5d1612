"""Values that cross the rooms: parameters, events, actions, estimates and errors; no behaviour."""
