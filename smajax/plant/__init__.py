"""The plant: drive -> heat -> material -> mechanism -> sensor."""
