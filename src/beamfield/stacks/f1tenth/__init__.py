"""The sensor model of MIT's racecar and F1TENTH."""
