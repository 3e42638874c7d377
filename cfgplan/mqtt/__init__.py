"""MQTT as a broker shows it: its traffic, Home Assistant's discovery messages, and environments made of them."""
