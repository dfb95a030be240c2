package iotcloud.bench.storm;

import java.util.Map;
import java.util.concurrent.atomic.AtomicLong;
import org.apache.storm.spout.SpoutOutputCollector;
import org.apache.storm.task.TopologyContext;
import org.apache.storm.topology.base.BaseRichSpout;
import org.apache.storm.tuple.Values;

/** Emits whenever Storm asks it. Tracked, it counts acked tuples as results. */
abstract class Source extends BaseRichSpout {
    private static final long SLOW_NS = 1_000_000;

    private final boolean tracked;
    private final int resultsOfItem;
    private transient SpoutOutputCollector collector;
    private transient AtomicLong done;
    private long next;
    private long lastSlow;

    Source(boolean tracked, int resultsOfItem) {
        this.tracked = tracked;
        this.resultsOfItem = resultsOfItem;
    }

    abstract Values item(long number);

    @Override
    public void open(Map<String, Object> conf, TopologyContext context, SpoutOutputCollector collector) {
        this.collector = collector;
        done = tracked ? Counters.ofTask() : null;
    }

    @Override
    public void nextTuple() {
        if (Counters.feed != Feed.FULL && !slowlyDue()) {
            return;
        }
        long number = next++;
        if (tracked) {
            collector.emit(item(number), number);
        } else {
            collector.emit(item(number));
        }
        Counters.emitted.lazySet(next);
    }

    private boolean slowlyDue() {
        long now = System.nanoTime();
        if (Counters.feed == Feed.NOTHING || now - lastSlow < SLOW_NS) {
            return false;
        }
        lastSlow = now;
        return true;
    }

    @Override
    public void ack(Object id) {
        Counters.add(done, resultsOfItem);
    }

    @Override
    public void fail(Object id) {
        Counters.failed.incrementAndGet();
    }
}
