"""State estimators of the motion of one object, behind one interface, and the prediction of all objects."""
