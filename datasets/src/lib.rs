//! Where magline gets its bytes: foreign formats, the simulator, the embedded samples.
