"""Plans of a fleet: made, certified and flown. It has no table: it is made when one of its methods is first called."""
