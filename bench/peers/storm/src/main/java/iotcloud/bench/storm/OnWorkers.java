package iotcloud.bench.storm;

import java.io.IOException;
import java.io.Serializable;
import java.io.UncheckedIOException;
import java.nio.file.Files;
import java.nio.file.Path;
import java.util.HashMap;
import java.util.Map;
import org.apache.storm.StormSubmitter;
import org.apache.storm.generated.StormTopology;
import org.apache.storm.shade.net.minidev.json.JSONValue;
import org.apache.storm.spout.SpoutOutputCollector;
import org.apache.storm.task.TopologyContext;
import org.apache.storm.topology.BasicOutputCollector;
import org.apache.storm.topology.OutputFieldsDeclarer;
import org.apache.storm.topology.TopologyBuilder;
import org.apache.storm.topology.base.BaseBasicBolt;
import org.apache.storm.topology.base.BaseRichSpout;
import org.apache.storm.tuple.Fields;
import org.apache.storm.tuple.Tuple;
import org.apache.storm.tuple.Values;

/**
 * Submits the DAGs of bench/storm/components.cc as plain Java: both do the same for each item. The two words are the
 * topology's configuration for Storm, and its items, as JSON.
 */
public final class OnWorkers {
    private OnWorkers() {}

    @SuppressWarnings("unchecked")
    public static void main(String[] words) throws Exception {
        Map<String, Object> conf = (Map<String, Object>) JSONValue.parse(words[0]);
        Items items = new Items((Map<String, Object>) JSONValue.parse(words[1]));
        StormSubmitter.submitTopology((String) conf.remove("topology.name"), conf, topology(items));
    }

    private static StormTopology topology(Items items) {
        TopologyBuilder builder = new TopologyBuilder();
        builder.setSpout("source", new PacedSource(items));
        if (!items.sentences.isEmpty()) {
            builder.setBolt("split", new Words.Split(), 2).shuffleGrouping("source");
            builder.setBolt("count", new Count(items), 2).fieldsGrouping("split", new Fields("word"));
        } else {
            builder.setBolt("pass", new Chain.Pass()).shuffleGrouping("source");
            builder.setBolt("sink", new Sink(items)).shuffleGrouping("pass");
        }
        return builder.createTopology();
    }

    /** What is sent, and where it is counted. */
    private static final class Items implements Serializable {
        private static final long serialVersionUID = 1;
        final String board;
        final boolean tracked;
        final int results;  // how many an item brings
        final int size;  // of a payload; 0: the item is a number, or a sentence of this file
        final String sentences;

        Items(Map<String, Object> given) {
            board = (String) given.get("board");
            tracked = (Boolean) given.get("tracked");
            results = ((Number) given.get("results")).intValue();
            size = ((Number) given.get("size")).intValue();
            sentences = (String) given.get("sentences");
        }
    }

    /**
     * Emits items at the rate that the benchmark sets. Tracked, it counts acked items as results, and how long after
     * their time they were acked.
     */
    private static final class PacedSource extends BaseRichSpout {
        private final Items items;
        private transient SpoutOutputCollector collector;
        private transient Board control;
        private transient Board own;
        private transient String[] sentences;
        private transient long rate;
        private transient long dueNs;
        private transient long count;

        PacedSource(Items items) {
            this.items = items;
        }

        @Override
        public void open(Map<String, Object> conf, TopologyContext context, SpoutOutputCollector collector) {
            this.collector = collector;
            control = Board.control(items.board);
            own = Board.of(items.board, context);
            try {
                sentences = items.sentences.isEmpty() ? new String[0]
                        : Files.readAllLines(Path.of(items.sentences)).toArray(new String[0]);
            } catch (IOException error) {
                throw new UncheckedIOException(error);
            }
        }

        @Override
        public void nextTuple() {
            long now = control.get(Board.RATE);
            if (now != rate) {
                rate = now;
                dueNs = System.nanoTime();
            }
            if (rate == 0) {
                return;
            }
            if (rate < 0) {
                emit(count);
            } else if (System.nanoTime() >= dueNs) {
                emit(dueNs);
                dueNs += 1_000_000_000 / rate;
            }
        }

        /** `id`: for an item that has a time, that time. */
        private void emit(long id) {
            if (items.tracked) {
                collector.emit(item(), id);
            } else {
                collector.emit(item());
            }
            count++;
            own.add(Board.EMITTED, 1);
        }

        private Values item() {
            if (sentences.length > 0) {
                return new Values(sentences[(int) (count % sentences.length)]);
            }
            if (items.size == 0) {
                return new Values(count);
            }
            byte[] bytes = new byte[items.size];
            bytes[0] = bytes[bytes.length - 1] = (byte) count;
            return new Values(bytes);
        }

        @Override
        public void ack(Object id) {
            own.add(Board.RESULTS, items.results);
            if (rate > 0) {
                own.record(System.nanoTime() - (Long) id);
            }
        }

        @Override
        public void fail(Object id) {
            own.add(Board.FAILED, 1);
        }

        @Override
        public void declareOutputFields(OutputFieldsDeclarer declarer) {
            declarer.declare(new Fields("item"));
        }
    }

    /** The last bolt. Untracked, it counts what it executed as results. */
    private abstract static class Last extends BaseBasicBolt {
        private final Items items;
        private transient Board own;

        Last(Items items) {
            this.items = items;
        }

        /** Returns false when it is not what was sent. */
        abstract boolean take(Tuple tuple);

        @Override
        public void prepare(Map<String, Object> conf, TopologyContext context) {
            own = Board.of(items.board, context);
        }

        @Override
        public final void execute(Tuple tuple, BasicOutputCollector collector) {
            if (!take(tuple)) {
                own.add(Board.FAILED, 1);
            }
            if (!items.tracked) {
                own.add(Board.RESULTS, 1);
            }
        }

        @Override
        public void declareOutputFields(OutputFieldsDeclarer declarer) {}
    }

    private static final class Sink extends Last {
        Sink(Items items) {
            super(items);
        }

        @Override
        boolean take(Tuple tuple) {
            Object item = tuple.getValue(0);
            if (!(item instanceof byte[])) {
                return true;
            }
            byte[] bytes = (byte[]) item;
            return bytes[0] == bytes[bytes.length - 1];
        }
    }

    private static final class Count extends Last {
        private transient Map<String, Long> words;

        Count(Items items) {
            super(items);
        }

        @Override
        public void prepare(Map<String, Object> conf, TopologyContext context) {
            super.prepare(conf, context);
            words = new HashMap<>();
        }

        @Override
        boolean take(Tuple tuple) {
            words.merge(tuple.getString(0), 1L, Long::sum);
            return true;
        }
    }
}
