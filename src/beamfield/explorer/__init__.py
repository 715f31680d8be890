"""See a log in its map, move the robot, and watch p(z | x, m) answer: in a browser, or in a notebook."""
