//! Locks and attempts of several hosts.

use super::*;

#[test]
fn unit_one_host_at_a_time_locks_a_pipeline() {
    let lab = Lab::new();
    let (here, there) = (lab.host(), lab.host());
    let (one, two) = (Store::open(here.path()).unwrap(), Store::open(there.path()).unwrap());
    let seen = generation(there.path(), "p");
    assert_eq!(seen, Some(0));
    let first = mine(one.lock("p").unwrap());
    assert!(first.follows(generation(there.path(), "p").or(Some(0))) && first.check().is_ok());
    assert_eq!(generation(there.path(), "p"), None);
    let LockOutcome::Held(held) = two.lock("p").unwrap() else { unreachable!("it is held") };
    // The two caches differ, so the lock of the operating system does not exclude the other host.
    assert_eq!(held.holder.as_ref().unwrap().pid, std::process::id());
    assert!(held.message("p", there.path()).contains("holds the lock in s3://bucket/lab/store: process"));
    mine(two.lock("q").unwrap());
    drop(first);
    let second = mine(two.lock("p").unwrap());
    assert!(!second.follows(seen), "another has had it since");
    // An apparently dead holder must not resume.
    let lease = "locks/p.lease-3";
    lab.bucket.put(lease, b"{}".to_vec()).unwrap();
    let fault = second.check().unwrap_err().to_string();
    assert!(fault.contains("now held by another process"), "{fault}");
    drop(second);
    assert!(matches!(one.lock("p").unwrap(), LockOutcome::Held(_)), "a lease that says nothing counts until it is old");
}

#[test]
fn unit_lease_of_a_killed_process_with_the_same_cache_ends_at_once() {
    let lab = Lab::new();
    let here = lab.host();
    let store = Store::open(here.path()).unwrap();
    // A killed process leaves its lease; the lock of the operating system is free.
    let lock = mine(store.lock("p").unwrap());
    let left = lab.bucket.get("locks/p.lease-1").unwrap().unwrap();
    drop(lock);
    lab.bucket.put("locks/p.lease-1", left).unwrap();
    assert_eq!(generation(here.path(), "p"), None);
    let again = mine(store.lock("p").unwrap());
    assert!(again.check().is_ok());
    assert_eq!(lab.bucket.list("locks").unwrap().len(), 1);
}

#[test]
fn unit_conditional_create_and_replace_have_one_winner() {
    let lab = Lab::new();
    let texts: Vec<String> = (0..8).map(|i| i.to_string()).collect();
    let won = each(&texts, |text| lab.bucket.create("x", text.as_bytes())).unwrap();
    assert_eq!(won.iter().filter(|w| **w).count(), 1);
    let (_, tag) = lab.bucket.get_tagged("x").unwrap().unwrap();
    let texts: Vec<String> = (10..18).map(|i| i.to_string()).collect();
    let won = each(&texts, |text| lab.bucket.replace("x", text.as_bytes(), Some(tag.clone()))).unwrap();
    assert_eq!(won.iter().filter(|w| **w).count(), 1);
    let there = lab.bucket.get("x").unwrap().unwrap();
    // A repeated write of the same content succeeds, because the first response may have been lost.
    assert!(lab.bucket.create("x", &there).unwrap());
}

#[test]
fn unit_attempts_are_counted_over_all_hosts() {
    let lab = Lab::new();
    let (here, there) = (lab.host(), lab.host());
    let (one, two) = (Store::open(here.path()).unwrap(), Store::open(there.path()).unwrap());
    let (first, second) = (one.attempt(&[key("a")]).unwrap(), two.attempt(&[key("a")]).unwrap());
    assert_eq!((one.attempts_at(&[key("a")])[0].lost, two.attempts().len()), (2, 1));
    first.end(&one, &HashMap::new());
    second.end(&two, &HashMap::from([(key("a"), &Fault::bug("a panic"))]));
    let tries = one.attempts_at(&[key("a")]).remove(0);
    assert_eq!((tries.lost, tries.failed), (0, 1));
    assert!(tries.why.unwrap().starts_with("a panic"));
    one.drop_attempts(|unit| unit == key("a"), None);
    assert_eq!(two.attempts().len(), 0);
}

#[test]
fn unit_large_attempt_uses_few_objects_and_foreign_ones_are_not_read() {
    let lab = Lab::new();
    let (here, there) = (lab.host(), lab.host());
    let (one, two) = (Store::open(here.path()).unwrap(), Store::open(there.path()).unwrap());
    let keys: Vec<HashKey> = (0..100).map(|i| key(&i.to_string())).collect();
    let (mine, others) = keys.split_at(98);
    let attempt = one.attempt(mine).unwrap();
    let all = lab.bucket.list("attempts").unwrap();
    assert_eq!(all.len(), 5);
    assert!(all.iter().all(|o| o.key.rsplit('/').next().unwrap().len() <= 128));
    let lost = |store: &Store, keys: &[HashKey]| store.attempts_at(keys).iter().map(|t| t.lost).collect::<Vec<_>>();
    assert_eq!((lost(&two, mine), lost(&two, others)), (vec![1; 98], vec![0; 2]));
    // An object without the mark of a unit is not read, even if it lists the unit.
    lab.bucket.put("attempts/strange-0000", format!("here\n{}\n", others[0]).into_bytes()).unwrap();
    let marked = others[0].to_string().starts_with("0000");
    assert_eq!(lost(&two, others), vec![usize::from(marked), 0]);
    lab.bucket.remove("attempts/strange-0000").unwrap();
    // Two units fail while the worker survives; another host has computed the others and one of these.
    let why = Fault::bug("a panic");
    attempt.end(&one, &HashMap::from([(mine[0], &why), (mine[97], &why)]));
    assert_eq!(lab.bucket.list("attempts").unwrap().len(), 2);
    two.drop_attempts(|key| key == mine[0], None);
    assert_eq!(two.attempts().keys().collect::<Vec<_>>(), [&mine[97]]);
    two.drop_attempts(|_| false, Some(Duration::ZERO));
    assert_eq!(lab.bucket.list("attempts").unwrap().len(), 0);
}
