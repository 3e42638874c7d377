"""Stream reasoning: metric temporal logic over the streams of semantic subscriptions (the engine of the paper's Figure 1)."""
