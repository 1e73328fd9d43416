"""Everything that talks to hardware or to a hardware file format."""
