package iotcloud.bench.storm;

import java.util.concurrent.atomic.AtomicInteger;
import org.apache.storm.Config;
import org.apache.storm.generated.StormTopology;
import org.apache.storm.topology.TopologyBuilder;
import org.apache.storm.tuple.Fields;

/** The application of the paper's measurements: what comes from the drivers' queues goes back to them. */
final class Echo {
    static final String URL = "bench.url";
    static final String NAME = "bench.name";  // of the exchange, and what the queues' names begin with
    static final String TRACKED = "bench.tracked";
    private static final AtomicInteger tasks = new AtomicInteger();

    private Echo() {}

    static StormTopology topology(Main.Options options, Config conf) {
        conf.put(URL, options.url);
        conf.put(NAME, options.name);
        conf.put(TRACKED, options.tracked);
        TopologyBuilder builder = new TopologyBuilder();
        builder.setSpout("receive", new RabbitSpout(), options.drivers);
        builder.setBolt("send", new RabbitBolt(), options.drivers).fieldsGrouping("receive", new Fields("driver"));
        return builder.createTopology();
    }

    /** A task has its connection. */
    static void taskConnected() {
        tasks.incrementAndGet();
    }

    static int connected() {
        return tasks.get();
    }
}
