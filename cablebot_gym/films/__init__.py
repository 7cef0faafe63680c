"""Episodes of policies, watched and filmed. Needs the extra ``render``."""
