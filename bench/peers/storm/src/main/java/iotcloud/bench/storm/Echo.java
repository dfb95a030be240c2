package iotcloud.bench.storm;

import java.util.concurrent.atomic.AtomicInteger;
import org.apache.storm.Config;
import org.apache.storm.generated.StormTopology;
import org.apache.storm.topology.TopologyBuilder;
import org.apache.storm.tuple.Fields;

/** The application of the paper's measurements: it sends the messages of the drivers' queues back to the drivers. */
final class Echo {
    static final String URL = "bench.url";
    static final String NAME = "bench.name";  // name of the exchange, and beginning of the queues' names
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

    /** A task calls it when it is connected. */
    static void taskConnected() {
        tasks.incrementAndGet();
    }

    static int connected() {
        return tasks.get();
    }
}
