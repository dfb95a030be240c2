package iotcloud.bench.storm;

import java.util.Map;
import java.util.concurrent.atomic.AtomicLong;
import org.apache.storm.task.TopologyContext;
import org.apache.storm.topology.BasicOutputCollector;
import org.apache.storm.topology.OutputFieldsDeclarer;
import org.apache.storm.topology.base.BaseBasicBolt;
import org.apache.storm.tuple.Tuple;

/** The last bolt. Untracked, it counts what it executed as results; tracked, the source counts what was acked. */
abstract class LastBolt extends BaseBasicBolt {
    private final boolean counts;
    private transient AtomicLong done;

    LastBolt(boolean tracked) {
        counts = !tracked;
    }

    abstract void take(Tuple tuple);

    @Override
    public void prepare(Map<String, Object> conf, TopologyContext context) {
        done = counts ? Counters.ofTask() : null;
    }

    @Override
    public final void execute(Tuple tuple, BasicOutputCollector collector) {
        take(tuple);
        if (counts) {
            Counters.add(done, 1);
        }
    }

    @Override
    public void declareOutputFields(OutputFieldsDeclarer declarer) {}
}
