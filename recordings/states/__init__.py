"""From samples to rows: when a state is settled, what is averaged, what is concluded. Pure: live equals replay."""
