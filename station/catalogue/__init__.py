"""All runs below a folder: what each says, found again fast, and what people say of them afterwards."""
