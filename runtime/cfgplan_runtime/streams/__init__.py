"""Streams between processes: elements, channels, inputs that change their source, and subscriptions to topics."""
