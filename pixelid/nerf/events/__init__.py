"""What events state: changes of light between them, chains of these, silence, and what they leave open."""
