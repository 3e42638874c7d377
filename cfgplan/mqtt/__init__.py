"""MQTT as a broker shows it: what came on its topics, what Home Assistant's discovery says of it, and environments."""
