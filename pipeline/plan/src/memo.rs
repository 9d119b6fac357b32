//! Cache of computed keys with bounded memory.

use std::sync::Mutex;

use schemas::keys::HashKey;

/// The maximum number of cached keys: they occupy 100 MB.
const MOST: u64 = 1 << 22;
/// Number of shards, large enough that threads rarely wait for each other.
const SHARDS: u64 = 64;

/// Cache of keys by number. If there are more numbers than slots, a key replaces an older key, which is recomputed on
/// demand.
pub struct KeyCache {
    shards: Vec<Mutex<Vec<[u64; 3]>>>,
    room: u64,
}

impl KeyCache {
    /// Creates a cache for numbers below `numbers`.
    pub fn new(numbers: u64) -> KeyCache {
        KeyCache::with_room(numbers.min(MOST))
    }

    fn with_room(keys: u64) -> KeyCache {
        KeyCache { shards: (0..SHARDS).map(|_| Mutex::default()).collect(), room: keys.div_ceil(SHARDS).max(1) }
    }

    fn place(&self, number: u64) -> (&Mutex<Vec<[u64; 3]>>, usize) {
        (&self.shards[(number % SHARDS) as usize], (number / SHARDS % self.room) as usize)
    }

    /// The key of `number`, if the key is cached.
    pub fn get(&self, number: u64) -> Option<HashKey> {
        let (shard, at) = self.place(number);
        let keys = shard.lock().ok()?;
        let [owner, low, high] = *keys.get(at)?;
        (owner == number + 1).then(|| HashKey::from_words([low, high]))
    }

    /// Caches the key of `number`.
    pub fn put(&self, number: u64, key: HashKey) {
        let (shard, at) = self.place(number);
        let Ok(mut keys) = shard.lock() else { return };
        if keys.is_empty() {
            // Zeros from the operating system, which occupy no memory until they are written.
            *keys = vec![[0; 3]; self.room as usize];
        }
        let [low, high] = key.words();
        keys[at] = [number + 1, low, high];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_the_cache_drops_keys_but_never_confuses_them() {
        let memo = KeyCache::with_room(100);
        let key = |n: u64| HashKey::from_parts([n.to_string()]);
        assert_eq!(memo.get(3), None);
        (0..1000).for_each(|n| memo.put(n, key(n)));
        let known = (0..1000).filter(|n| memo.get(*n).is_some()).count();
        assert!((100..=128).contains(&known), "{known}");
        assert!((0..1000).all(|n| memo.get(n).is_none_or(|k| k == key(n))));
        // The last 100 keys are still cached.
        assert!((900..1000).all(|n| memo.get(n) == Some(key(n))));
    }
}
