package iotcloud.bench.storm;

import java.util.List;
import java.util.concurrent.CopyOnWriteArrayList;
import java.util.concurrent.atomic.AtomicLong;

/** How much the sources send. */
enum Feed { FULL, SLOW, NOTHING }

/** Counts of what the components of the only worker have done. Each counter has one writer. */
final class Counters {
    static final AtomicLong emitted = new AtomicLong();
    static final AtomicLong failed = new AtomicLong();
    static volatile Feed feed = Feed.FULL;
    private static final List<AtomicLong> ofTasks = new CopyOnWriteArrayList<>();

    private Counters() {}

    /** A new counter for the results that one task finishes. */
    static AtomicLong ofTask() {
        AtomicLong counter = new AtomicLong();
        ofTasks.add(counter);
        return counter;
    }

    static void add(AtomicLong counter, long more) {
        counter.lazySet(counter.get() + more);
    }

    static long results() {
        return ofTasks.stream().mapToLong(AtomicLong::get).sum();
    }
}
